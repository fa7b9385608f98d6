"""The elastica: an inextensible beam whose coordinates are the tangent angles at its nodes (theory, eq. 5.2)."""
