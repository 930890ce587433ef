"""Only for the comparison with the published code.

- `edge_strain`: a film whose strain is that of bars along the edges (`film.law = "edge_strain"`).
- `hinges`: edges that its examples leave without springs (`chamber.all_hinges = false`).
- `open_caps`: for the tangent of open ends, which is not symmetric (`chamber.closed = false`). What the
  missing caps take from gradient and tangent is in `cosim.soft.elements.pressure`.
"""
