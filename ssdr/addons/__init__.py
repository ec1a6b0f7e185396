"""Add-ons for other programs, which run the command ``ssdr``; none of them is imported here."""
