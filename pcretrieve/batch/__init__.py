"""Scan to signature, one or many: the pipeline, and isolated workers that run it."""
