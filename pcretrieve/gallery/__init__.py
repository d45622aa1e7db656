"""A catalogue made searchable: what is fitted to its shapes, and the answers to questions.

In come a catalogue and a scan; out come its signatures, an index of them, and ranked shapes with a verdict.
"""
