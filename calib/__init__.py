"""Tables in, fitted robots out."""
