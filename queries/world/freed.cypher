// Another entity has taken this one's node of the plan.
MATCH (n:Entity {id: $id})
SET n.node = ''
