"""Neural ensembles: an alternative to contact models, trained on the same transitions."""
