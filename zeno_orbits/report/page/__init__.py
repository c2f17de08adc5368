"""The report of an orbit: one HTML page that needs no server and no network.

Values in, the text of the page out. The plots are drawn in the reader's browser by plotly, whose
bundle travels inside the page; the numbers and the words are there without it.
"""

from zeno_orbits.report.page.page import page_of
from zeno_orbits.report.page.plotly_bundle import Bundle, load_bundle
from zeno_orbits.report.page.subject import Subject, subject_of

__all__ = ["Bundle", "Subject", "load_bundle", "page_of", "subject_of"]
