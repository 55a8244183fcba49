"""Many scenarios at once: a table `[sweep]`, its members, and the dataset that they leave."""
