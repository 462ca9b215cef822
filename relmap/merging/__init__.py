"""Maps of two runs made one, where what they share ties them in one way alone."""
