"""A finished study in one file: study, results, inputs, environment and hashes; and what is wrong with such a file."""
