"""The elastica: an inextensible beam by the tangent angles of its nodes (theory, eq. 5.2)."""
