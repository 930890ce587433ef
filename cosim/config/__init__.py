"""The file format: scenarios and robots are read, checked and written; no engine is loaded."""
