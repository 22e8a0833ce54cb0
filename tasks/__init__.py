"""The bundled tasks, one folder each; cmbrl knows them only by their entry points."""
