"""The collapsed likelihood of a model (34): its tableau, searches over models, lists of models."""
