"""The search page: a server of the shapes of one catalogue, for browsers and for scripts.

In come requests by HTTP; out come pages, pictures and JSON documents. Every request passes `guard`, which
knows the token. Handlers are functions of a catalogue in `views` and `documents`; `application` alone knows
the web framework.
"""

from pcretrieve.web.server import serve

__all__ = ["serve"]
