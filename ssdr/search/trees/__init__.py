"""Trees over bones: where joints lie, and the steps that find and use them."""
