// Body of integrate in integrate_functions of arithmetic.py.
alignas(64) run weighted[$columns];
for (int n = 0; n < $columns; ++n)
    weighted[n] = runs(mass.data)[e * $columns + n] * runs(b.data)[e * $columns + n];
const auto to = runs(out.data) + e * of_all + first;
for (int k = 0; k < $rows; k += 4) {
    const int count = $rows - k < 4 ? $rows - k : 4;
    const auto row = m.data + (first + k) * $columns;
    run sums[4] = {};
    const auto add = [&](int r, int n) { sums[r] += row[r * $columns + n] * weighted[n]; };
    for (int n = 0; n < $columns; ++n)
        if (count == 4) { add(0, n); add(1, n); add(2, n); add(3, n); }
        else for (int r = 0; r < count; ++r) add(r, n);
    for (int r = 0; r < count; ++r) to[k + r] = sums[r];
}
