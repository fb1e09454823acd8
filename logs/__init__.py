"""The recordings of the cell: one MCAP a cycle; reading, comparing and displaying them."""
