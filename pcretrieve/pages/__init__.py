"""HTML pages about catalogues and scans.

In comes a catalogue or an `Inspection`; out come self-contained HTML files and pictures. Nothing is imported
here, because the search page needs some of these modules only, and an inspection all stages of a scan.
"""
