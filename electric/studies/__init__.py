"""The source papers' simulations: what they claim, and what comes out."""
