// Return which frames of a sequence have boxes annotated, are keyframes, or have an image.
MATCH (f:Frame) WHERE f.sequence = $sequence
RETURN f.frame AS frame, f.annotated AS annotated, f.keyframe AS keyframe, f.image AS image ORDER BY frame
