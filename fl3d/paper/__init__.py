"""What a paper needs, from a store: tables, figures, claims and one page. Trains nothing."""
