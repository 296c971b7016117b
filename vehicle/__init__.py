"""How the car moves, how to estimate it and how to control it. Imports no other room."""
