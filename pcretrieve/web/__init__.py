"""The search page: a server of the shapes of one catalogue, for browsers and for scripts.

In come requests by HTTP; out come pages, pictures and JSON documents. Every request passes `guard`, which
knows the token; `application` has the addresses.
"""

from pcretrieve.web.server import serve

__all__ = ["serve"]
