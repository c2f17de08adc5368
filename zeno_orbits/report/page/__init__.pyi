from .page import page_of as page_of
from .plotly_bundle import Bundle as Bundle
from .plotly_bundle import load_bundle as load_bundle
from .subject import Subject as Subject
