"""Drawing of a garment on its body."""
