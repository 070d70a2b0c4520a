"""Whether columns of tables are taken for what they are: names and records drawn anew."""
