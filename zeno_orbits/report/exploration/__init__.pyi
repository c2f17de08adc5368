from .attractor import ExploredAttractor as ExploredAttractor
from .attractor import attractor_at as attractor_at
from .explore import explore as explore
