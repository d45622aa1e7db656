"""The experiments of the paper on its own descriptor, repeated.

In come the meshes of TOSCA and two flat drums; out come tables of figures beside those of the paper [1]_.

References
----------
.. [1] J. Ye and Y. Yu, "A fast modal space transform for robust nonrigid shape retrieval", The Visual
   Computer 32, 2016.
"""
