"""How a garment on its body is shown."""
