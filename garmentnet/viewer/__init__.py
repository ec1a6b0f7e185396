"""A trained garment as a page in which it dances; the browser predicts it."""

from .page import Take, write_page

__all__ = ["Take", "write_page"]
