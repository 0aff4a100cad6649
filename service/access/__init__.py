"""Who may do what: API keys, ownership, limits per caller."""
