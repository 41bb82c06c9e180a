// names: the conditions of all descriptions of a sequence, in the order in which proofs leave them out.
MATCH (n:Name) WHERE n.sequence = $sequence RETURN n.id AS id, n.conditions AS conditions ORDER BY id
