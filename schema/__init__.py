"""What is stored and said: types, tables, rules, geometry, wording, marks and errors. Imports nothing else of ours."""
