// Body of product in arithmetic.py.
run r = *runs(&p);
r *= *runs(&q);
return as_value(r);
