"""Export of maps to the formats of other programs, listed in `formats.FORMATS`."""
