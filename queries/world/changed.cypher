// Set the kind and the node of an existing entity.
MATCH (n:Entity {id: $id})
SET n.kind = $kind, n.node = $node
