MATCH (p:Person) RETURN p.track ORDER BY p.track
MATCH (p:Person)-[a:Performs]->(b) WHERE a.certain RETURN p.id, count(*) ORDER BY p.id LIMIT 5
MATCH (p:Person)-[s:SeenIn]->(f:Frame {frame: $frame}) RETURN p.track, s.box.x ORDER BY p.track
MATCH (a:Person), (b:Person), (c:Person), (d:Person), (e:Person), (f:Person), (g:Person) RETURN count(*)
MATCH (p:Person) DETACH DELETE p
MATCH (p:Person) SET p.track = 1 RETURN p
CREATE (p:Person {id: 'x'})
LOAD FROM '/etc/passwd' (HEADER=false) RETURN *
COPY (MATCH (p:Person) RETURN p.*) TO '/tmp/people.csv'
EXPORT DATABASE '/tmp/out'
ATTACH '/tmp/x.db' AS x (DBTYPE duckdb)
CALL show_tables() RETURN *
INSTALL httpfs
MATCH (p:Person) RETURN p.id; MATCH (p:Person) DELETE p
UNWIND range(1, 100000000) AS x RETURN sum(x)
MATCH (p:Person) /* DELETE */ RETURN 'DELETE', `p`.id // CREATE
RETURN map([1, 2], ['a', 'b'])
WITH [1, 2, 3] AS l RETURN list_transform(l, x -> x / 0)
MATCH p = (a:Person)-[*1..30]->(b) RETURN count(p)
RETURN repeat('x', 2000000000)
RETURN cast('nan' AS DOUBLE), 1/0, 9223372036854775807 + 1
