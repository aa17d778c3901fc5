// Body of sum_at_point in arithmetic.py.
const auto at = runs(c.data);
const auto part = [&](int k) { return values.data[k * $points + n] * at[k]; };
run sum = part(0), modes = {};
for (int k = 1; k < $smooth; ++k) { const run hat = part(k); sum += hat; }
for (int k = $smooth; k < $smooth + 4; ++k) {
    const run first = part(k + 4), second = part(k + 8), both = part(k);
    const run along = first + second;
    const run corner = both + along;
    modes += corner;
}
sum += modes;
return as_value(sum);
