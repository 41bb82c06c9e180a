// Set the kind and the plan node of an existing entity.
MATCH (n:Entity {id: $id})
SET n.kind = $kind, n.node = $node
