"""What one scan shows: its walls, their corners, and its beams."""
