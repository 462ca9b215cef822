"""Other methods of finding planes, to compare with."""
