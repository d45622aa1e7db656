"""Pages to look at.

In come a catalogue or an `Inspection`; out come self-contained HTML files and pictures.
"""
