"""What runners call: files in, rooms called, files out."""
