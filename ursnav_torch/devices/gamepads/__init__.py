"""What the operator holds."""
