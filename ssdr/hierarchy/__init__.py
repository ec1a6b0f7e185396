"""Trees over bones: who is whose parent, transforms relative to it, how bones are drawn."""
