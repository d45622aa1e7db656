"""Many scans into a catalogue.

In come files, folders, globs and manifests; out comes one row of a catalogue for every scan, computed by
isolated worker processes.
"""
