"""Maps in the formats of other programs; `formats.FORMATS` names them."""
