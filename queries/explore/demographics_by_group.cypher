// Number of people in each group by gender and age. Only certain members count.
MATCH (p:Person)-[m:MemberOf]->(g:SocialGroup)
WHERE m.sequence = $sequence AND m.certain
RETURN g.cluster AS cluster, g.venue AS venue, p.gender AS gender, p.age AS age, count(DISTINCT p.track) AS people
ORDER BY cluster, venue, gender, age;
