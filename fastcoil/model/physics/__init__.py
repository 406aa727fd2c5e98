"""The paper's plant, Eqs (1) to (4) and Fig 6: one scalar function per formula, a file per block."""
