"""What makes data: body, motion, cloth and simulator.

Needs the extra ``scenes``; nothing outside this package imports it but the command, and that
only where it simulates.
"""
