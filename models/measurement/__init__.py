"""What is measured of an emitter: one file per measurement model (ALGORITHMS §1)."""
