"""What of the kidney was seen, what is next, and the way there."""
