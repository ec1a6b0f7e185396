"""Trees over bones: parents, transforms relative to the parent, bone ends for drawing."""
