// Evidence of edges of the plan: for each slot, pair of entities and frame the sum of the weights of the relation.
MATCH (n:Entity {episode_hash: UUID($hash)})-[r:Related]->(m:Entity), (s:Slot {episode_hash: UUID($hash)})
WHERE s.kind = 'edge' AND s.name = r.name AND s.origin = r.origin AND r.step <= $step
  AND (s.origin = 'model' OR s.frame = r.frame)
RETURN s.number AS slot, n.name AS source, m.name AS target, r.frame AS frame, min(r.write) AS first,
       sum(r.weight) AS weight
ORDER BY slot, first, frame, source, target
