"""Web page in which the browser predicts a trained garment for some motions."""

from .page import Take, write_page

__all__ = ["Take", "write_page"]
