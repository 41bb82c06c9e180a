// action_search: two steps lead to a person at t0 who later starts an action somewhere else: the first stable segment
// of it after t0, seen in a direction more than $turn degrees away from that at t0.
MATCH (:Description)-[n:Names]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)<-[:`Is`]-(:Person)
      -[:Does]->(s:Segment)
WHERE n.general AND c.id <> a.id
  AND s.start >= c.t + $search AND s.quiet_from <= c.t
  AND abs(s.angle - c.angle) > $turn AND abs(s.angle - c.angle) < 360 - $turn
RETURN n.id AS name, a.id AS at0, s1.relation AS r1, b.id AS b, s2.relation AS r2, c.id AS c, s.id AS segment,
       n.anchor AS anchor,
       a.clear AND b.clear AND c.clear AND s.first_clear AS evidence,
       a.image AND s.first_image AS image,
       s.first_ahead AS ahead
ORDER BY name, r1, r2, segment
