"""relmap beside other methods, one run at a time or in a grid."""
