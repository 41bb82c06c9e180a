// action_search: two relations lead to a person who later starts an action in another direction.
MATCH (n:Name)-[:Describes]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)
      <-[:At]-(p:Person)-[:Acts]->(s:Segment) WHERE b.sequence = $sequence AND c.id <> a.id AND a.clear AND b.clear
  AND s.start >= c.frame + $search AND s.quiet_from <= c.frame AND abs(s.angle - c.angle) > $turn AND c.clear
  AND abs(s.angle - c.angle) < 360 - $turn AND s.first_clear AND a.image AND s.first_image AND NOT s.first_ahead
RETURN n.id AS name, s.id AS segment, a.frame AS t0, a.track AS a, b.track AS b, c.track AS c, s1.relation AS r1,
       s2.relation AS r2 ORDER BY name, segment, r1, r2
