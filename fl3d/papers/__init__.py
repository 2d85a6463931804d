"""Papers whose results fl3d makes again: a folder each, with published cells, tables, figures and claims."""
