"""How far a unit force on one ball moves another, and local densities of states."""
