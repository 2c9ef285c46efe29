"""The simulated bench: what moves, and the true rates and forces. It may import lbgc, which never
imports it."""

from .opengl import settle

settle()
