// Body of put_picked in memory.py; the processor's own gathers are slow.
#pragma clang loop vectorize(disable) unroll_count(2)
for (int i = first; i < first + lanes; ++i) out.data[i] = wp::$given(x.data[places.data[i]]);
