"""What others use to find planes."""
