"""Bytes and text below the campaign's formats: TOML, CSV, EXIF, LAS records. Used by `campaign` alone; no file layout here."""
