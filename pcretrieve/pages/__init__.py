"""HTML pages about catalogues and scans.

In comes a catalogue or an `Inspection`; out come self-contained HTML files and pictures.
"""
