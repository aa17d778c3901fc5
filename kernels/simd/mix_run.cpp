// Body of mix_run in stages.py.
const run start = *runs(x.data + at);
run sum = start;
for (int k = first; k < last; ++k) {
    run change = *runs(levels.data + size_t(k) * levels.shape[1] + at);
    change -= start;
    change *= weights.data[k];
    sum += change;
}
*runs(out.data + at) = sum;
