"""Arguments, output and steps that several verbs share."""
