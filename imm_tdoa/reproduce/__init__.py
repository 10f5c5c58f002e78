"""Published comparisons computed again: their tables, their pictures, and what corrects them."""
