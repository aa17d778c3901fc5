// Body of put_as in memory.py, for arrays of the number type $given.
const auto each = reinterpret_cast<const number*>(&v);
for (int lane = 0; lane < lanes; ++lane)
    x.data[i + lane] = wp::$given(each[lane]);
