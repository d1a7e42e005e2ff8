"""A fit tried on data that it was not made on."""
