"""The site of the documents: the same files, made ready for mkdocs."""
