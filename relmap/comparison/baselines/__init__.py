"""What people would use instead of relmap."""
