"""Clients of the command ``ssdr`` for other programs; none of them is imported here."""
