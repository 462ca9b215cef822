"""Result folders, tables, journals and saved states."""
