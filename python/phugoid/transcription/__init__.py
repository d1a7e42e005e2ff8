"""How an estimation is posed: collocation, shooting, the filter-error method."""
