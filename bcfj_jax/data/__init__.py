"""Measured files of any kind as tables of named columns in SI, without a word of contact. Reading order: table, readers."""
