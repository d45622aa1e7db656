"""How well shapes of one class find each other."""
