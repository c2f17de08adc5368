from .contact_damping import damping_number as damping_number
from .contact_damping import effective_restitution as effective_restitution
from .cycles import SettledRig as SettledRig
from .cycles import cut_cycles as cut_cycles
from .default_stop import default_rig as default_rig
from .cycles import settle_rig as settle_rig
