"""Benchmarks of the library, and checks of the paper's claims.

In come folders of labelled meshes, named by ``--data``, and simulated bodies; out come printed tables. Every
program has a function ``main``, which `scripts/benchmark NAME` calls.
"""
