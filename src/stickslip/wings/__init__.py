"""Wings: what stands on the laboratory, a package each; nothing of a wing is imported before it is used."""
