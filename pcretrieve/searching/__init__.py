"""Catalogue and queries → ranked shapes.

In come a catalogue, and scans, stored shapes or signatures; out come the identifiers of the nearest shapes
and their distances.
"""

from pcretrieve.searching.answering import answer_to, search, search_many
from pcretrieve.searching.answers import Answer
from pcretrieve.searching.duplicates import duplicates
from pcretrieve.searching.queries import Described, pictured
from pcretrieve.searching.rows import result_rows

__all__ = [
    "Answer",
    "Described",
    "answer_to",
    "duplicates",
    "pictured",
    "result_rows",
    "search",
    "search_many",
]
