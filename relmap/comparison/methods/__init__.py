"""Methods that can be compared: one small file each, behind one protocol."""
