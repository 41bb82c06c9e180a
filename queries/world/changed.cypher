// Kind and node of an entity that is there.
MATCH (n:Entity {id: $id})
SET n.kind = $kind, n.node = $node
