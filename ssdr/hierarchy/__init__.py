"""Trees over bones: parents, transforms relative to the parent, and bone ends for drawing."""
