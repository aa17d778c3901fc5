// Body of columns_products in arithmetic.py.
for (int k = at.data[g]; k < at.data[g + 1]; ++k) {
    run product = runs(values.data)[k] * runs(y.data)[g];
    const auto each = reinterpret_cast<number*>(&product);
    for (int half = lanes / 2; half > 0; half /= 2)
        for (int i = 0; i < half; ++i) each[i] += each[i + half];
    out.data[k] = each[0];
}
