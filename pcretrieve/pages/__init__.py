"""HTML pages about catalogues and scans.

In comes a catalogue or an `Inspection`; out come self-contained HTML files and pictures.
"""

from pcretrieve.pages.inspection_page import inspect, write_inspection_page, write_inspection_png
from pcretrieve.pages.map_page import draw_map
from pcretrieve.pages.queries_page import query_page
from pcretrieve.pages.retrieval_page import report

__all__ = [
    "draw_map",
    "inspect",
    "query_page",
    "report",
    "write_inspection_page",
    "write_inspection_png",
]
