// Body of row in arithmetic.py; entry k multiplies $factor, where `from` points to x[places[k]].
const auto part = [&](int k) {
    const auto from = x.data + places.data[k];
    return $entry * $factor;
};
run sum = {};
for (int k = at.data[g]; k < at.data[g + 1]; ++k) sum += part(k);
return as_value(sum);
