"""Pictures of surfaces and point clouds.

In come arrays of vertices and faces, or of points; out come shaded pictures, made by ray casting without a
display, and figures by matplotlib.
"""
