"""Many scans into a catalogue.

In come files, folders, globs and manifests; out comes one row of a catalogue for every scan, computed by an
executor, by default in isolated worker processes. Nothing is imported here, because the search page needs the
processes only, and an ingest all stages of a scan.
"""
