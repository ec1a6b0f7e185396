"""The steps of the method: start, weights, rest pose, bones, polish."""
