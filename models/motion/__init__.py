"""How emitters move: one file per motion model (ALGORITHMS §2)."""
