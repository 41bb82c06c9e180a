// Return the people who may have a relation with a person: by a label, or because a list of labels was not read.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.t AS t, q.v AS v, q.kind AS kind, q.person AS person
MATCH (n:Person)-[s:SeenIn]->(f:Frame) WHERE n.sequence IN $scopes AND f.id = at AND n.id = person
WITH id, t, v, kind, n, s, f MATCH (m:Person)-[z:SeenIn]->(f) WHERE m.sequence IN $scopes AND m.id <> n.id
  AND NOT z.covered OPTIONAL MATCH (n)-[r:Beside|Interacts|MayInteract]->(m) WHERE r.label = v
  AND r.first <= t AND r.last >= t
WITH id, kind, s, m, z, count(r) AS labels, coalesce(max(r.certain), false) AS certain
WHERE labels > 0 OR NOT CASE kind WHEN 'social' THEN s.interactions_listed AND z.interactions_listed
                                  WHEN 'first' THEN s.robot_view_listed AND z.robot_view_listed
                                  ELSE s.person_view_listed AND z.person_view_listed END
RETURN id, m.track AS who, certain ORDER BY id, who
