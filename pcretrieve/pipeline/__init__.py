"""One scan through all stages.

In comes a scan, as a file or as arrays; out come its surface, its spectrum and its signature.
"""
