{% from "head.ls" import head %}
{{ head(name, plan.made) -}}
   0:  !plan {{ plan.hash }} ;
{% for module in modules %}
{% if not loop.first and not module.stays %}
   0:  MESSAGE[take the bar off] ;
   0:  PAUSE ;
{% endif %}
   0:  CALL {{ module.name }}    ;
{% endfor %}
/POS
/END
