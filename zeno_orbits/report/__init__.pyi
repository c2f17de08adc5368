from .motion import orbit_motion as orbit_motion
from .page import Subject as Subject
from .page import load_bundle as load_bundle
from .page import page_of as page_of
from .plots import figure_of as figure_of
from .terminal import line_for_watcher as line_for_watcher
