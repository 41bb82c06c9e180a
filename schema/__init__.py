"""What all packages share: types, tables, rules, geometry, wording, marks and errors. Imports nothing else of ours."""
