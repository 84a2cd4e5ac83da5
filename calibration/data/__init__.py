"""Measured data: files of any kind become checked records in SI. Reading order: table, readers, preparation."""
