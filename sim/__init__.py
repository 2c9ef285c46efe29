"""The bench: what moves, and what the sensors feel. It may import lbgc; lbgc never imports it."""

from .opengl import settle

settle()
