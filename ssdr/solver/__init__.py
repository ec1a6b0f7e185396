"""The steps of the method: start, weights, rest pose, bones, polish.

Two steps solve for weights: ``vertex_step`` of ``alternation.py``, with the best of all bones, and
the polish, ``vertex_newton.py``, which has the last word.
"""
