-- Number of questions in each family, the same number in the paper, the hops, and the mean number of words.
SELECT family, count(question_id) AS n, n / greatest(sum(count(question_id)) OVER (), 1) AS share, paper,
       string_agg(DISTINCT hops::INT, ', ' ORDER BY hops::INT) AS hops, sum(words) / nullif(n, 0) AS words
FROM families
LEFT JOIN measured USING (family)
GROUP BY family, paper
ORDER BY family;
